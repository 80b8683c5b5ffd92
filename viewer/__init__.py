"""Every picture: result documents in, pictures out; asks nobody."""
