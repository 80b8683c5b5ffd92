"""PC3: how light travels from the chips to the receiver, and what a camera sees of it."""
