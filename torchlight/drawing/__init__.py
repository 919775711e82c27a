"""Matplotlib's part of a result's pictures: from arrays and words to PNG bytes, without torch.

Whoever draws a result puts it into the arrays of `content`; `elsewhere` has them drawn, by a process of its own where
one was begun.
"""
