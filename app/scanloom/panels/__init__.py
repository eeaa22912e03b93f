"""One file for each panel: widgets that change the view, and what they show of the result."""
