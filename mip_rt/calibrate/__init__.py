"""`mip-rt calibrate`: measures one unit, refuses bad data and says why, and keeps the result for later runs."""
