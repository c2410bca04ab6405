"""Drawing primitives of the figures: canvas, figure model, floor maps, number format. Reads no dataset."""
