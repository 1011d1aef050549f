"""`mip-rt doctor`: looks at every layer between the board and a balancing robot, and says what is wrong and what to do."""
