"""KUKA KR210 pick and place in MuJoCo, from the xacro to the scored cycle."""

__version__ = "0.1.0.dev0"
