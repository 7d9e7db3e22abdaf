"""Files: cell files and exports of recordings."""
