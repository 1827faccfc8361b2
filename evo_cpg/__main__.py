"""The command line, as ``python -m evo_cpg``."""

from evo_cpg.cli.main import program

if __name__ == "__main__":
    program()
