"""Ground truth for training: classes, instances and boxes, in the files of data sets.

The simulation has the body of each point. Data sets have their own classes, axes and files. These modules translate,
and place the box of a body where the cloud shows it while the sensor, the body or both move.

kinds          names and numbers that data sets give to the classes of scene files
boxes          3D boxes and how visible they are
files          class and instance of each point; label files beside a cloud
kitti_dataset  whole data sets in KITTI's folders
osi_truth      ground truth as ASAM OSI
"""
