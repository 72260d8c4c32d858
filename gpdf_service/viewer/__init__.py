"""See it: pictures without a browser (`picture`), and the operator's page (`page`), a client of a running service."""
