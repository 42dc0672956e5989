"""The missing equation: terms of a grammar of the chain's quantities, tested as effects, held out on another motion."""
