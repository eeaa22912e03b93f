"""What the workbench shows, without the browser: pictures and geometry from the stages' results."""
