"""What a robot is: its model, estimators, controller and compiled step."""
