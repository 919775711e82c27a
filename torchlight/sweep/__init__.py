"""Sweeps: which settings find the light best, by grid, at random or by Optuna; `run` reads as the story."""
