"""Light on its way: laser pulse and beam, surfaces, air, receiver, sunlight."""
