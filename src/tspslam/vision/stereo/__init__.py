"""A pair of images to points: matching along rows, disparity maps, triangulation."""
