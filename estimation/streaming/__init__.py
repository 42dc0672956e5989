"""Streamed estimation: fits of recordings and chunks by summed square-root information, in bounded memory."""
