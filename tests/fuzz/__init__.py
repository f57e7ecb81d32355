"""Gives damaged files to every reader: each must be refused by name, or read as something valid.

`readers` lists them, each with a function that writes small valid files and one that reads them and
checks the value; `damage` and its siblings change a file at random; `judge` says how reading ends;
`worker` is the process in which that happens, with limits of memory and time, and `campaign` runs
it. The number of an input is the seed of all that is random in it.
"""
