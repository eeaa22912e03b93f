"""The page below the panels: its script and storage, layout, live pictures, markup."""
