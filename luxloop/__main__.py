"""`python -m luxloop` is the `luxloop` command."""

from luxloop.cli import main

if __name__ == "__main__":
    main()
