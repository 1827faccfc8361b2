"""The graph of scalars: its types, its verifier and its printer."""
