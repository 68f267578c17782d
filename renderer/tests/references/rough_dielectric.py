"""Reference of the test `refraction_agrees_with_mitsuba` in src/material/clear.rs: values of Mitsuba's `roughdielectric` (GGX) times
the cosine, for radiance, in the local frame of the surface. The first direction is the viewer's, as Mitsuba's `wi` is.

    pip install mitsuba==3.* numpy && python rough_dielectric.py > rough_dielectric.csv
"""

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")


def direction(cosine, azimuth):
    sine = (1.0 - cosine * cosine) ** 0.5
    return mi.Vector3f(sine * np.cos(azimuth), sine * np.sin(azimuth), cosine)


print("ior,alpha,ox,oy,oz,ix,iy,iz,value")
for ior in (1.33, 1.5, 1.75):
    for alpha in (0.05, 0.2, 0.6, 1.0):
        bsdf = mi.load_dict(
            {"type": "roughdielectric", "distribution": "ggx", "alpha": alpha, "int_ior": ior, "ext_ior": 1.0, "sample_visible": True}
        )
        for outer in (0.95, 0.5, 0.15, -0.9, -0.4):
            for inner in (0.9, 0.3, -0.95, -0.8, -0.5, -0.1):
                for azimuth in (0.0, 1.3, 3.0):
                    interaction = mi.SurfaceInteraction3f()
                    interaction.wi = direction(outer, 0.4)
                    interaction.sh_frame = mi.Frame3f(mi.Normal3f(0, 0, 1))
                    interaction.n = mi.Normal3f(0, 0, 1)
                    wo = direction(inner, 0.4 + azimuth)
                    value = bsdf.eval(mi.BSDFContext(mi.TransportMode.Radiance), interaction, wo)[0]
                    if value > 1e-4:
                        numbers = [ior, alpha, *interaction.wi, *wo, value]
                        print(",".join(f"{float(number):.7g}" for number in numbers))
