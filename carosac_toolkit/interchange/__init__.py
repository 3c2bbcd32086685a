"""Robots and recordings of other programs: CASPR, WireX and cdpyr robots, ROS bags and MCAP files.

A reader takes what its format holds and says what it leaves; it invents nothing. What a robot file
needs beyond that is asked for, all of it at once (`carosac_toolkit.interchange.completion`).
"""
