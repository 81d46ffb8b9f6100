"""Colours of the things that were outlined or labelled in real captures, seen by eye: what the built-in encoder knows.

By capture and thing: its colour, or "" where it has several; colours that it has in part, of which it counts neither
way. NOT_THERE: colours that nothing in the photos has.
"""

TRUTH = {
    "plush": {
        "carrot": ("orange", "red green"), "quilt": ("grey", "white purple"), "wardrobe": ("brown", "orange"),
        "doll": ("", "white blue pink purple grey black"),
    },
    "apc_shelf": {
        "laugh_out_loud_joke_book": ("red", "white"), "kleenex_tissue_box": ("blue", "green black grey"),
        "i_am_a_bunny_book": ("blue", "green red yellow brown black grey"),
        "creativity_chenille_stems": ("", "red green purple pink white grey orange blue brown"),
    },
    "desk_penguin": {
        "bag": ("red", "black white grey"), "case": ("white", ""), "mouse": ("white", ""),
        "mat": ("green", "black white"), "notes": ("pink", "purple"), "kettle": ("grey", "black white brown"),
        "laptop": ("black", "grey white blue"), "penguin": ("grey", "black white yellow orange"),
        "cup": ("", "green grey white brown yellow"), "lid": ("", "green grey white brown yellow"),
    },
    "brighton_beach": {
        "lawn": ("green", "yellow brown"), "island": ("green", "brown yellow"), "table": ("green", "grey blue"),
        "car_1": ("black", "grey"), "car_2": ("", "grey white blue"), "car_3": ("", "grey white black"),
        "car_4": ("red", ""), "car_5": ("black", "grey blue"), "car_6": ("", "grey blue black"),
        "shelter": ("grey", "brown white black"),
    },
}  # fmt: skip
NOT_THERE = {"plush": "yellow", "desk_penguin": "purple", "brighton_beach": "orange pink purple yellow"}
