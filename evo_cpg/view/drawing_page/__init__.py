"""The drawing tool: a creature's YAML as a document that people edit on a page of the browser."""
