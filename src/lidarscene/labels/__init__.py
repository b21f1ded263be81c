"""Ground truth for training: classes, instances and boxes, in the files of data sets.

The simulation knows what each point is of. Data sets say it in their own words, axes and files. Here is the
translation, and what a box shows of a body while the sensor, the body or both move.

kinds          the classes of scene files in the words of data sets
boxes          3D boxes and how visible they are
gathered       boxes of a frame that comes in pieces
files          class and instance of each point; label files beside a cloud
kitti_dataset  whole data sets in KITTI's folders
osi_truth      ground truth as ASAM OSI
"""
