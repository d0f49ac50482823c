"""Types of numbers, distributions, and work in a second process: nothing that knows an arm."""
