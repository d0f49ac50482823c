"""The true arm on its lander: bodies, errors that it has, equilibrium at rest, controllers."""
