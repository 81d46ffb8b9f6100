"""Films of a scene: smooth paths of a camera, one picture after the other, and files that play.

No more than a few pictures are held at a time, however long the film.
"""
