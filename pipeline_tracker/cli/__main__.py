"""``python -m pipeline_tracker.cli``: the command line."""

from pipeline_tracker.cli.entry import main

if __name__ == "__main__":
    main()
