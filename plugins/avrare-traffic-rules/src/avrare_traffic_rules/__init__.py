"""Interstate traffic rules R_G1, R_G2, R_G4, R_I2 and no-collision as temporal logic."""
