"""The simulated scene, measured: how real it looks, what each term is worth, how fast it runs."""
