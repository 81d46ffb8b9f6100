"""The verbs of the command line, in the groups and with the summaries of --help, which loads nothing else of them."""

GROUPS = {
    "make a scene": {
        "scan": "scan photos or a video in one go: poses, a scene, masks, a field, its objects and a page to open",
        "capture": "estimate the camera poses of photos or a video with COLMAP, as a capture for train and embed",
        "train": "train a scene of Gaussians on posed photos (3D Gaussian Splatting), on a CPU or on CUDA",
        "photograph": "render a scene that has no photos from planned poses, as a capture for embed and register",
        "tile": "cut a huge scene, or its blocks, into tiles that register with little memory",
        "motion": "inspect a moving scene, or convert it to a file that drsplat reads fast or to numbered PLY files",
    },
    "make it searchable": {
        "embed": "cut posed photos into masks (SAM) and embed each (CLIP), for drsplat register",
        "codebook": "train a codebook on patches of LVIS or on embeddings, for all scenes of an encoder",
        "register": "register the masks of posed photos onto the Gaussians of a scene, as a searchable field",
        "add": "add views to a field: only they are computed, and the result equals registering all at once",
        "remove": "remove views from a field, as if they had never been registered",
        "field": "transfer a field to another file of its scene, e.g. a compressed one",
        "objects": "list the objects of a scene without a query: where they are, how large, and in which photos",
    },
    "ask": {
        "locate": "locate the matches of a query in a scene: where they are, how large, and their supporting photos",
        "select": "select the Gaussians that match a query: by a threshold, given or automatic, or by a share",
        "segment": "label every Gaussian with the best of some classes, or with none of them",
        "when": "find when an object of a moving scene is on, in, next to, above, left or right of another",
        "catalogue": "store the objects of many scenes in one folder, and search them all at once",
    },
    "look and change": {
        "view": "view and search a scene in the browser, or write it as a page that needs no server",
        "render": "render a scene as pictures or a film, optionally with the matches of a query highlighted",
        "edit": "edit objects of a scene: remove, recolour, move, copy, replace, undo; its file is unchanged",
        "export": "write a scene, its named objects and the answer to a query as a file for other programs",
    },
    "serve": {
        "serve": "answer queries on the scenes of a folder over HTTP",
        "mcp": "let language models query the scenes of a folder (Model Context Protocol)",
    },
    "try, check and measure": {
        "demo": "search a small built-in scene: mask its photos, embed, register, query, and check the answers",
        "inspect": "describe any file or folder: a scene, a capture, features, a field, tiles, a catalogue or a "
        "codebook",
        "doctor": "report what is installed, what can run on this machine and what is missing",
        "evaluate": "score fields, or features of other systems, with a protocol from the papers",
    },
}
SUMMARIES = {name: summary for verbs in GROUPS.values() for name, summary in verbs.items()}
