# SPDX-License-Identifier: Apache-2.0
"""Whether joints, touch and f* fit each other: what does not fit is wrong, however it looks.

A blind hand has no truth to compare with, but it knows some things twice:

- A contact lies on its fingertip: p_c = p_f(theta) + r n. Wrong joint angles and wrong contact
  points break that.
- The squeezing forces of (13) add up to one: sum f*_n = 1.
- What the contacts press is what the motors press, by (3):
  J_h^T f_c = tau - M_h theta'' - C_h theta' - N_h. Forces of one finger or of all that are out of
  proportion, and forces that do not change while the torque does, break that.
"""
