"""Files and arrays as points in metres, z up, whole or in chunks."""

from gpdf_service.clouds.read import PointCloud as PointCloud
from gpdf_service.clouds.read import check_finite as check_finite
from gpdf_service.clouds.read import check_labels as check_labels
from gpdf_service.clouds.read import check_points as check_points
from gpdf_service.clouds.read import read_cloud as read_cloud
