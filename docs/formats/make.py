"""Write the pages of this folder and the JSON Schemas from the models that check the files.

python docs/formats/make.py
"""

from pathlib import Path

from interarea.formats import write

for file in write(Path(__file__).resolve().parent):
    print(file)
