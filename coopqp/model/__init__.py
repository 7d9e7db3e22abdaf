"""What is there: arms, cell, grasp, closed chain."""
