"""Files: descriptions of cells, exports."""
