"""Images to points: calibration, features, matching, triangulation."""
