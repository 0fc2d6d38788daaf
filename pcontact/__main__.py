"""``python -m pcontact``."""

from pcontact.cli import main

if __name__ == "__main__":
    main()
