"""Pictures with axes that a slider drives or a click picks in, and plots of curves with hover."""
