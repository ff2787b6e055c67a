"""Ten lines for your own plant: describe, run, look."""

import undeadzone as uz

scenario = uz.Scenario(
    plant=uz.Plant(A=[[0, 1], [-1, -2]], B=[[0], [1]], C=[[1, 0]], x0=[0.5, 0]),
    sensor=uz.Sensor(right=1.0, left=0.7),
    reference=uz.Sine(amplitude=5.0, frequency=1.0),
    observer=uz.Certified(L=[-0.87, 0.76], gamma=7.7),
    controller=uz.StateFeedback(poles=[-8.0, -10.0]),
)
run = uz.simulate(scenario)
print(run.summary())
uz.plot(run, "your_plant.png")
