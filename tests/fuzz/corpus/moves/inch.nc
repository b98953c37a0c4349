G20
G17
(a comment)
N10 G0 X1. Y-.5
G18 G2 X0 Z1 I0 K.5 F10
%
