"""Photos and videos: their poses, the models that cut and embed them, and the features that this gives.

`capture` poses, `models` are segmenters and encoders, `embedding` applies them to photos on disk and resumes,
`arriving` adds photos to a field while it is in use. Begin with `embedding/embed.py`.

Imports `scene`, `formats`, `kernels` and `field`.
"""
