"""Pure dynamics and kinematics: equations without filters, clocks, configuration or I/O."""
