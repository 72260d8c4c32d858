"""Guidance of people along a planned trajectory: instructions, speech, haptic cues; and a simulated walker."""
