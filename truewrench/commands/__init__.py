"""Commands of `truewrench`, one per file: options and execution."""
