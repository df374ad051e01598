"""Control of one robot: from its measurements to its command. Pure functions of plain numbers."""
