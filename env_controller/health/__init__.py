"""What `luxloop doctor` looks at: this host, its certificates, what the router lets its role do."""
