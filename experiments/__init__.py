"""The paper, reproduced and answered: one small script for each figure and table, and for each question it leaves open."""
