"""stub"""
from __future__ import annotations
import numpy as np
from scipy import ndimage
def image_of(light, grid, half, camera, pose, there):
    node, weight = np.polynomial.legendre.leggauss(3)
    c=np.cos(np.radians(pose.rotation_deg)); s=np.sin(np.radians(pose.rotation_deg))
    out=np.zeros((camera.rows,camera.columns))
    co=ndimage.spline_filter(light,order=5,mode="mirror")
    for a,wa in zip(node,weight):
        for b,wb in zip(node,weight):
            r=np.arange(camera.rows)[:,None]+a/2-(camera.rows-1)/2-pose.shift_row_px
            q=np.arange(camera.columns)+b/2-(camera.columns-1)/2-pose.shift_column_px
            x=camera.pixel_um*(q*c+r*s); y=camera.pixel_um*(r*c-q*s)
            f=ndimage.map_coordinates(co,[y/grid.step_um+grid.size//2-.5,x/grid.step_um+grid.size//2-.5],order=5,mode="mirror",prefilter=False)
            out+=wa*wb/4*f*(abs(x)<=half)*(abs(y)<=half)
    return out
