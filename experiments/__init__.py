"""The paper, reproduced and answered: a small script for each figure, each table and each question left open."""
