"""Files of recordings: the format ``carosac-recording/1`` as Parquet and CSV, and importers.

One table, sorted by time, one row per distinct time stamp; a cell is null (CSV: empty) where its
channel has no sample at that time. Each channel fills all of its columns in a row or none.

=========  ==================================================================================
channel    columns, cables numbered from 01
=========  ==================================================================================
(time)     ``time_s``
lengths    ``unstrained_length_01_m`` ... (required)
rates      ``length_rate_01_m_per_s`` ...
tensions   ``tension_01_N`` ... at the platform
commands   ``unstrained_length_command_01_m`` ...
poses      ``position_x_m`` y z (platform origin in world frame W), ``quaternion_w`` x y z (P to W)
IMU        ``imu_angular_rate_x_rad_per_s`` y z, ``imu_specific_force_x_m_per_s2`` y z
=========  ==================================================================================

A JSON document goes with the table: in Parquet under the key ``carosac`` of the schema's metadata,
in CSV as comment lines (``# ``) on top. It has ``schema``, ``rows``, ``metadata`` (see
`RecordingMetadata`), ``exit_points_m`` and, for readers, ``units`` and ``rates_hz``. Numbers are
float64 in Parquet and the shortest text that reads back to the same float64 in CSV.

A table without that document is read by its column names alone; ``cable_length_1_m`` is then
another name of ``unstrained_length_01_m``, and ``exit_point_1_x_m`` y z give measured exit points,
of which the medians are kept.
"""
