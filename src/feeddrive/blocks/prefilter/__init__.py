"""What changes the setpoint before the law sees it."""
