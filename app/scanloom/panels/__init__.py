"""The panels, one file each: widgets that change the view and display its results."""
