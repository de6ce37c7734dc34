"""stand-in"""
import numpy as np
from dataclasses import dataclass
import sarkit.wgs84 as w
@dataclass(frozen=True)
class Anchor:
    latitude: float = 0.84
    longitude: float = 0.2
    height: float = 500.0
    @staticmethod
    def of_degrees(a,b,h): return Anchor(float(np.radians(a)),float(np.radians(b)),float(h))
    @property
    def origin(self): return w.geodetic_to_cartesian([np.degrees(self.latitude),np.degrees(self.longitude),self.height])
    @property
    def axes(self):
        la,lo=self.latitude,self.longitude
        return np.array([[-np.sin(lo),np.cos(lo),0],[-np.sin(la)*np.cos(lo),-np.sin(la)*np.sin(lo),np.cos(la)],[np.cos(la)*np.cos(lo),np.cos(la)*np.sin(lo),np.sin(la)]])
    def to_ecef(self,p): return np.asarray(p)@self.axes+self.origin
    def from_ecef(self,p): return (np.asarray(p)-self.origin)@self.axes.T
    def to_geodetic(self,p):
        g=w.cartesian_to_geodetic(self.to_ecef(p)); g=np.array(g); g[...,:2]=np.radians(g[...,:2]); return g

    def from_geodetic(self,g):
        g=np.array(g); g[:,:2]=np.degrees(g[:,:2])
        return self.from_ecef(w.geodetic_to_cartesian(g))
