"""What a command leaves for people: one page with its figures and tables."""
