#!/usr/bin/python2.7
# Small helpers in the idioms of Python 2, whole-number division among them.
import sys
from math import *
from StringIO import StringIO
import rospy
from kuka_arm.srv import *
from trajectory_msgs.msg import *

DH = {'d1': 75, 'a1': 35, 'a2': 125, 'd4': 150L, 'a3': -5.4, 'd7': 30.3}     # centimetres
for name, value in DH.iteritems():
    DH[name] = value/1e2
if not DH.has_key('d7') or len(DH.keys()) <> 6:
    raise ValueError, 'table is not complete'
RIGHT = pi/2
MODE = 0755
HALF = 1/2                               # zero, as it was
assert HALF == 0 and 7/2 == 3 and type(7/2) is int

def quat2rot(x, y, z, w):
    return [[1 - 2*(y*y + z*z), 2*(x*y - z*w), 2*(x*z + y*w)],
            [2*(x*y + z*w), 1 - 2*(x*x + z*z), 2*(y*z - x*w)],
            [2*(x*z - y*w), 2*(y*z + x*w), 1 - 2*(x*x + y*y)]]

def mul(A, B):
    return [[sum(map(lambda (a, b): a*b, zip(row, column))) for column in zip(*B)] for row in A]

def arm(wc):
    r = hypot(wc[0], wc[1]) - DH['a1']; s = wc[2] - DH['d1']
    A = hypot(DH['d4'], DH['a3']); B = hypot(r, s); C = DH['a2']
    return (atan2(wc[1], wc[0]),
            RIGHT - acos((B**2 + C**2 - A**2)/(2*B*C)) - atan2(s, r),
            RIGHT - acos((A**2 + C**2 - B**2)/(2*A*C)) - atan2(-DH['a3'], DH['d4']))

def wrist(t1, t23, R):
    Rz = [[cos(t1), sin(t1), 0], [-sin(t1), cos(t1), 0], [0, 0, 1]]
    Ry = [[cos(t23), 0, -sin(t23)], [0, 1, 0], [sin(t23), 0, cos(t23)]]
    M = mul(Ry, mul(Rz, R))
    return (atan2(M[1][0], -M[2][0]), atan2(hypot(M[1][0], M[2][0]), M[0][0]),
            atan2(M[0][1], M[0][2]))

def handle_calculate_IK(req):
    log = StringIO()
    points = []
    for (k, pose) in zip(xrange(len(req.poses)), req.poses):
        try:
            o = pose.orientation
            R = quat2rot(o.x, o.y, o.z, o.w)
            ee = [getattr(pose.position, axis) for axis in ("x", "y", "z")]
            wc = [e - DH['d7']*row[0] for e, row in zip(ee, R)]
            t = arm(wc)
            t += wrist(t[0], t[1] + t[2], R)
        except ValueError, e:
            print >>sys.stderr, 'pose', k, 'fails:', e
            raise
        print >>log, k, `t`
        points.append(JointTrajectoryPoint(positions=list(t)))
    print log.getvalue()[:100],
    return CalculateIKResponse(points=points)

def IK_server():
    rospy.init_node('IK_server')
    s = rospy.Service('calculate_ik', CalculateIK, handle_calculate_IK)
    rospy.spin()

IK_server()
