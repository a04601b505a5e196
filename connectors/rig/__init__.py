"""The simulated rig: a scene, its physics and the sources that it offers, a peer of the hardware."""
