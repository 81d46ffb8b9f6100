"""What a photo is cut into: masks by level, which of them are kept, their crops, and a photo's features.

Imports nothing but errors and words for people.
"""
