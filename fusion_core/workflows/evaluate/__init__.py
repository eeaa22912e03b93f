"""``scanloom evaluate``: the measures of a result against what is known to be true."""
