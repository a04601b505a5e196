"""TakkTile fingertips on an I2C bus."""
