"""How far a sensor sees a target and how well: SNR, range, detection, sensitivities. Nothing is traced."""
