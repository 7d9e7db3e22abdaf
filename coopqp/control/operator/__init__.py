"""The operator's hand: reverse, step, jog, return, shift, gear."""
