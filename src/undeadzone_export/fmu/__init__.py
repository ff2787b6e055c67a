"""The exported C as a functional mock-up unit (FMU) for co-simulation, FMI 2.0 and 3.0."""
