"""Whether one V never rises, whatever the sensor shows."""
