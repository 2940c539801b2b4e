"""The search over all yaws and positions, and the candidates that it leaves."""
