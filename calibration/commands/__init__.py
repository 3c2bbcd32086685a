"""Commands of ``carosac`` that calibrate."""
