"""How a batch or a cloud in tiles goes on a fleet: costs fitted to measurements, and a simulated scheduler."""
