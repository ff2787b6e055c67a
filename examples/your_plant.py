"""Ten lines for your own plant: describe, run, look."""

import undeadzone as uz

scenario = uz.Scenario(
    plant=uz.Plant(A=[[0, 1], [-1, -2]], B=[0, 1], C=[1, 0], x0=[0.5, 0]),
    sensor=uz.Sensor(right=1.0, left=0.7, noise=0.01),
    reference=uz.Sine(amplitude=5.0, frequency=0.5),
    observer=uz.Auto(right=[0.0, 2.0]),
    simulation=uz.Simulation(time="sampled", step=0.01),
)
run = uz.simulate(scenario)
print(run)
uz.plot(run, "your_plant.png")
