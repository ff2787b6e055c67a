"""The ends of a plant: the sensor's dead zone, play and range; the actuator's zone and limits."""
