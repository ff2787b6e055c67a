"""`python -m undeadzone` is the command line."""

from undeadzone.cli import main

if __name__ == "__main__":
    main()
