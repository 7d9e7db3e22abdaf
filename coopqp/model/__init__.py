"""The model: arms, cell, state, grasp, closed chain, inverse kinematics."""
