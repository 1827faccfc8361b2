"""The page that `evo-cpg watch --page` serves: its HTML, style and scripts."""
