"""Detection of what inflates a score: data shared between splits or with training, constant answers."""
