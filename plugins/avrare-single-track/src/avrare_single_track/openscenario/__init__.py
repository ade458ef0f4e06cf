"""OpenSCENARIO XML as scenarios: what is read, and the traffic that acts it out."""
