"""The commands of `truewrench`, one to a file: the options that each takes, and what it does with them."""
