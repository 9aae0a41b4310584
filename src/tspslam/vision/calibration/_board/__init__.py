"""What a calibration from views of a board is made of."""
