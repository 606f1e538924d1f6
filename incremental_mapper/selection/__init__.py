"""Selection: one window in, its best connected candidate out (paper, Algorithm 1, steps 3 to 5).

Puts the window's problem together, enumerates or searches its candidates, has them solved and
scored, and picks one. Nothing is changed here: the mapper commits what is chosen.
"""
