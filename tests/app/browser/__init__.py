"""A package, unlike the other folders of tests: its fixtures end with it, not with the session. A
browser that stays open would keep its event loop in the thread of every later test."""
