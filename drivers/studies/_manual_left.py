"""Cases that the verification manual does not have, and why: benchmarks without a number to compare with."""

LEFT = (
    "**NAFEMS CGS-4, a loaded pin** (A. W. A. Konter, *Advanced Finite Element Contact Benchmarks*, R0094): what is "
    "public of it are curves over the angle, contact pressure, tangential stress and slip, in the verification manual "
    "of OptiStruct (OS-V: 0230). code_aster V6.03.156 (SSNP156) names a displacement and a pressure of Abaqus and Marc "
    "as its reference, on a mesh that is not the benchmark's; its command files test no value. "
    "[A pinned joint](../pinned_joint.md) is like it, with statics as its check.",
    "**step-42 of deal.II, a ball pressed into an elastoplastic box**: its page prints the contact force on two "
    "meshes, 37.3058 with 512 cells and 56.794 with 14,652, and goes no further. That is no reference, the force has "
    "grown by a half. [A rigid ball in a perfectly plastic block](ssnv506.md) is like it.",
)
