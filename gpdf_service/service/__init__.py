"""The map service and the planner service over Zenoh, their log, and its replay."""
