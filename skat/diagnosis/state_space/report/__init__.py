"""The findings of a diagnosis as what a page shows, as sentences, and as data for programs."""
