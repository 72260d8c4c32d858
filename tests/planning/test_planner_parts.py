"""The planner's own small parts, each beside what it says."""

