"""The camera's path: odometry against a map that grows, relocalisation, loop closing, bundle adjustment."""
