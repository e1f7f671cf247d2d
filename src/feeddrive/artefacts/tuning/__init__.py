"""What `feeddrive tune` leaves behind: the report and the machine file."""
