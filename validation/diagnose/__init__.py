"""Which physical effect the model lacks: score tests, refits, what they explain, and an honest verdict."""
