"""Command line ``carosac``: a thin shell over Python calls."""
