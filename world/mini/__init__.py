"""How the built-in encoder `mini` is learned from this world; needs torch and mitsuba."""
