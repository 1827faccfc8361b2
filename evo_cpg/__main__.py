"""Entry point of ``python -m evo_cpg``, the command line."""

from evo_cpg.cli.main import program

if __name__ == "__main__":
    program()
