"""The browser application: a plain state object, views that draw it, no computation of its own."""
