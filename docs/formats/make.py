"""Write the pages of this folder and the JSON Schemas from the models that check the files.

python docs/formats/make.py
"""

import argparse
from pathlib import Path

from interarea.formats import write

if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    for file in write(Path(__file__).resolve().parent):
        print(file)
