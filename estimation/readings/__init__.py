"""How recordings are read: what may be mistaken in a log, tested before any physics is looked for."""
