"""The plant: a robot in MuJoCo with surfaces, tip friction, disturbances and simulated sensors."""
