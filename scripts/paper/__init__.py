"""The paper's experiments, one file per step: setting, truth, methods, measurement, tables, pictures."""
