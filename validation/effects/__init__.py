"""Effects from outside: which there are, what each does to images and curves, which look alike, new ones."""
