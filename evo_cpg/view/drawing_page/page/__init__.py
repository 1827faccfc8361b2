"""The page of the drawing tool, and the server that it talks to."""
