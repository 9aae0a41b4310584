"""The live viewer: a run in a browser, with viser (extra ``viewer``). It is given frames and maps, and reads no folder.

Nothing of it is imported before it is asked for, so viser may be absent.
"""
