"""Values of an estimate: result, interval, notes, confidence distributions."""
