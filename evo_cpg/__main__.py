"""The command line, as ``python -m evo_cpg``."""

from evo_cpg.cli.main import main

if __name__ == "__main__":
    main()
